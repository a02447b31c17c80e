"""Files in and out: readers of records, the campaign file, results folders, checks at the door."""
