"""Learned models: a mixture of Gaussians over Fourier weights, and a phase model."""
