"""From a checked YAML document to a layout."""
