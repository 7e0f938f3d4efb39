"""What has been made: recipes, the store that keeps products, and the catalogue of layers."""
