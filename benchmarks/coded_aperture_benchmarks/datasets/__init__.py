"""What is measured on: frames whose truth is known."""
