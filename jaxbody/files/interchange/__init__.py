"""Files of other programs: data sheets of mounts, models of MuJoCo, linear systems for MATLAB."""
