"""What ordinary frames say of a lens that was set up before: no targets, no known distances."""
