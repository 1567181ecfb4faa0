"""The document of an identification: schema, records, and the tasks it asks for."""
