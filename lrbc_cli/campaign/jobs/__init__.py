"""All jobs of a campaign: decides what to run (``plans``, ``identity``), identifies (``run``), judges (``judging``) and writes results."""
