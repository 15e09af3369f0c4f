"""What is in a picture: tags, and by lens and place of the camera where they are."""
