"""What others would do with a recording, beside the diagnosis."""
