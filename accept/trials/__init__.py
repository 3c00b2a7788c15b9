"""Bad inputs and damaged files, each a small change to a good case, given to the command line and judged."""
