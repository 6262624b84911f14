"""What commands say and where results go."""
