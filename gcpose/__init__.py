"""GC-Pose, the method of the paper: joint motion of an articulated object from video."""
