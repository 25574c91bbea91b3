"""Direct and global light of skin, estimated by the thesis's network (`direct`)."""
