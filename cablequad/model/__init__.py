"""What moves: bodies, cables, their equations of motion, and the linear model of them."""
