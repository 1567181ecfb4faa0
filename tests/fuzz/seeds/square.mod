MODULE Square
  PERS tooldata spindle := [TRUE,[[0,0,150],[1,0,0,0]],[5,[0,0,80],[1,0,0,0],0,0,0]];
  PERS wobjdata part := [FALSE,TRUE,"",[[800,0,300],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  CONST robtarget p10 := [[-10,0,20],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST speeddata slow := [50,500,5000,1000];
  PROC main()
    MoveJ p10,v100,fine,spindle\WObj:=part;
    MoveL Offs(p10,0,0,-21),slow,z0,spindle\WObj:=part;
    MoveL [[30,0,-1],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],slow,z1,spindle\WObj:=part;
    MoveC [[40,10,-1],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],
      [[30,20,-1],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],slow,fine,spindle\WObj:=part;
    WaitTime 0.5;
  ENDPROC
ENDMODULE
