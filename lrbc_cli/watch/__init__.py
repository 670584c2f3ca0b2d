"""The command ``lrbc watch``: identifies, judges and reports jobs as their measurement files arrive."""
