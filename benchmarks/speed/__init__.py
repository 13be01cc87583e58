"""Times and memory, beside other programs and other commits. Ratios of processor times of interleaved runs."""
