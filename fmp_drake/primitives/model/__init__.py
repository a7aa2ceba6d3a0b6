"""What is learned: a mixture of Gaussians over Fourier weights."""
