"""A catalogue compared with images: verdict, windows and report."""
