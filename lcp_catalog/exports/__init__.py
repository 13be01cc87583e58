"""A catalogue in the files of other programs: tables, maps, landmark files."""
