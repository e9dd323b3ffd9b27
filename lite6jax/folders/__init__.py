"""What is done with every file of a folder, on this machine or behind a URL: listed, fitted, and written into a table."""
