"""The .proto files of our own topics and the module generated from them (`python -m logs.schema.generate`)."""
