"""Programs of JAX: jit with options that compile quickly, times of compilation, programs
on disk."""
