"""Forward and inverse kinematics, singularities and configurations."""
