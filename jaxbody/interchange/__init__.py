"""Files of others: data sheets of mounts, linear systems for MATLAB."""
