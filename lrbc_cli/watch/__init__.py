"""Jobs that are identified, judged and reported as their files arrive."""
