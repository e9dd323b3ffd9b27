"""What can be diagnosed: each domain turns a recording into an estimation problem."""
