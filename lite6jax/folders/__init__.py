"""What is done with every file of a folder, on this machine or behind a URL: listed, fitted, put into a table."""
