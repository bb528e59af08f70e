"""What makes the pages of the documents that come from the code; `docs/build.py` writes them."""
