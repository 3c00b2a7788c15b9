"""From a case to subdomains with pixels and their local systems."""
