"""Many runs as one study, on this machine or on a cluster."""
