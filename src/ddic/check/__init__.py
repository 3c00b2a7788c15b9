"""What is checked of a case before anything is measured."""
