"""What judges a student's function against its reference and explains what is wrong with it."""
