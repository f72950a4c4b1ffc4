"""Warp kernels, the same code on the CPU and on CUDA, and the functions that launch them."""
