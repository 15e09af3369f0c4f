"""What a study leaves: pages, figures and tables."""
