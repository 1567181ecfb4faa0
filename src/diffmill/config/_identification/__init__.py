"""The document of an identification: schema, records, and the study it asks for."""
