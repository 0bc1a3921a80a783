"""Models of the machines served: uploaded, verified, kept, activated, rolled back."""
