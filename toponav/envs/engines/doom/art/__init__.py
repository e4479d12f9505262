"""What a maze looks like: textures, paintings, marks and sprites."""
