"""Spring, reversal and delay of a joint from its two encoders and its torque."""
