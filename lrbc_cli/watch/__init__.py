"""Identifies, judges and reports jobs as their files arrive."""
