"""Effects that move the tool: of joints, of links, and of what surrounds the arm."""
