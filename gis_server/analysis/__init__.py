"""What can be measured on the maps and in the images, asked by the endpoints of `routes`."""
