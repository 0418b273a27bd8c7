"""The image files of a capture: photos in the formats of cameras, their EXIF data, and ground truth as OpenEXR files."""
