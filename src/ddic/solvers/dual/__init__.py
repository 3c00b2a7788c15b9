"""The dual Schur complement: exchange, operator, preconditioner, step."""
