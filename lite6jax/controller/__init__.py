"""A UFACTORY controller on the network: the one part of the library that opens sockets."""
