"""Programs of JAX: options and times of compilation, derivatives and batches outside a jit, programs on disk."""
