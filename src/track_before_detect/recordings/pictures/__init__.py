"""Pictures in files: what each library reads, as frames."""
