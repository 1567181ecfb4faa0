"""Long paths: segment after segment."""
