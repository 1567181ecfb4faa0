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
    q := p10;
    FOR i FROM 1 TO 3 STEP 2 DO
      q.trans.x := q.trans.x + 10*Sin(30)/i;
      row{i} := RelTool(q,0,0,i\Rz:=45);
      IF i = 1 AND NOT i > 5 THEN
        cut row{i}, -i \deep, n;
      ELSEIF n <> 2 THEN
        MoveL Offs(q,0,0,half(n)),v50,z1,spindle\WObj:=part;
      ENDIF
    ENDFOR
    TEST n
    CASE 1,2:
      VelSet 50, 100;
    DEFAULT:
      Stop;
    ENDTEST
    WHILE n < 3 DO n := n + 1; ENDWHILE
    MoveL q,slow,fine,spindle\WObj:=part;
  ENDPROC
  VAR robtarget q;
  VAR robtarget row{3};
  VAR num n := 0;
  PROC cut(robtarget at, num depth \switch deep, INOUT num count)
    MoveL Offs(at,0,0,depth),v20,z0,spindle\WObj:=part;
    count := count + 1;
  ERROR
    RETRY;
  ENDPROC
  FUNC num half(num v)
    RETURN v/2;
  ENDFUNC
ENDMODULE
