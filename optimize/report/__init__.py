"""Reports: single HTML files with pictures, and what they are drawn with."""
