"""What an arm is: chains and their conversion, descriptions, factory files, URDF, MJCF, inertia, inverse dynamics."""
