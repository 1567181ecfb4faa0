"""The milling robot: an elastic-joint arm, its dynamics and its statics.

What it models: a tree of rigid links built from elements in any order; each joint
hangs on its motor by a spring and a damper, tau = K (theta - q) + D (thetad - qd),
the motor standing at the controller's output. A virtual joint has the spring but no
motor. Backlash, friction and motors with a mass on a servo are there where their data
are. Assumptions: all elasticity is in joints, springs and dampers are linear but for a
gap; what motors do of their command, a `Controller` tells. Compliance and modes are
those of the springs with motors locked and no gap. Left out: the motors' currents, and
contact with anything but the tool. Gravity is 9.81 m/s^2 along -z of `base`, unless the
base is tilted. A wrench is external, acts on the robot at the tool's origin in base
axes, linear part first; Jacobian and compliance are written likewise.
"""

from ._algebra.rotations import (
    rotation_matrix as rotation_matrix,
    rpy_matrix as rpy_matrix,
)
from ._control.controller import Controller as Controller
from ._control.nominal import (
    NominalRobot as NominalRobot,
    placed_motors as placed_motors,
)
from ._dynamics.crba import mass_matrix as mass_matrix
from ._dynamics.energy import mechanical_energy as mechanical_energy
from ._dynamics.forward import forward_dynamics as forward_dynamics
from ._dynamics.rnea import (
    gravity_forces as gravity_forces,
    inverse_dynamics as inverse_dynamics,
)
from ._dynamics.rnea_derivatives import rnea_derivatives as rnea_derivatives
from ._dynamics.terms import ArmTerms as ArmTerms
from ._elasticity.compliance import (
    cartesian_compliance as cartesian_compliance,
    gravity_sag as gravity_sag,
    principal_stiffness as principal_stiffness,
    static_deflection as static_deflection,
)
from ._elasticity.damped_modes import damped_modes as damped_modes
from ._elasticity.modes import (
    mode_shapes as mode_shapes,
    natural_frequencies as natural_frequencies,
)
from ._elasticity.receptance import receptance as receptance
from ._elasticity.static_balance import (
    loaded_equilibrium as loaded_equilibrium,
    motor_positions as motor_positions,
)
from ._elasticity.tip_modes import TipModes as TipModes
from ._elasticity.workspace import (
    StiffnessMap as StiffnessMap,
)
from ._files.drive_classes import drive_classes as drive_classes
from ._files.errors import (
    RobotFileError as RobotFileError,
    RobotFileWarning as RobotFileWarning,
)
from ._files.load import (
    built_in_models as built_in_models,
    load as load,
    spindle_note as spindle_note,
)
from ._kinematics.configurations import (
    configurations as configurations,
    path_starts as path_starts,
)
from ._kinematics.forward import (
    forward_kinematics as forward_kinematics,
    jacobian as jacobian,
)
from ._kinematics.inverse import (
    JointSolution as JointSolution,
    inverse_kinematics as inverse_kinematics,
    inverse_kinematics_path as inverse_kinematics_path,
)
from ._kinematics.pose_error import ToolRotation as ToolRotation
from ._kinematics.singularity import singularity as singularity
from ._kinematics.skeleton import Skeleton as Skeleton
from ._model.bending_tool import (
    BendingTool as BendingTool,
)
from ._model.build import build as build
from ._model.elements import (
    FixedRotation as FixedRotation,
    FixedTranslation as FixedTranslation,
    Fork as Fork,
    Mimic as Mimic,
    PrismaticJoint as PrismaticJoint,
    RevoluteJoint as RevoluteJoint,
    RigidBody as RigidBody,
    Tool as Tool,
)
from ._model.flange_spring import (
    FlangeSpring as FlangeSpring,
)
from ._model.link_errors import LinkErrors as LinkErrors
from ._model.robot import (
    Robot as Robot,
)
