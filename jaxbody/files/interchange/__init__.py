"""Files of others: data sheets of mounts, models of MuJoCo, linear systems for MATLAB."""
