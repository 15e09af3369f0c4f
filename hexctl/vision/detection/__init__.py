"""What is in a picture: tags, and by lens and pose of the camera where they are."""
