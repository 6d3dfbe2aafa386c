"""The languages of the YAML files of sequences, stations and mappings."""
