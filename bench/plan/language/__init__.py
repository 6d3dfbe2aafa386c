"""What the YAML files of sequences, stations and mappings may say."""
