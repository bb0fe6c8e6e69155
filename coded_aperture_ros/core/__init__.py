"""What every room uses: errors, options with units and ranges, files, threads, timing."""
