"""GC-Pose, the method of the paper. Built by a later issue; see the README."""
