"""What builds a rig, from the command line: parts, board, targets, dimensions."""
