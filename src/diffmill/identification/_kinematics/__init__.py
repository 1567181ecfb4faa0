"""Link errors of a robot from poses measured under a tracker."""
