"""A first campaign file for a folder of exports, with what is assumed and missing marked."""
