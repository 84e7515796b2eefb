"""Files: glTF, USD, OBJ, volumes, datasets of pictures."""
