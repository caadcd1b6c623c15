"""What a result rests on: package, environment, inputs."""
