"""What is drawn and told: surfaces, plots, reports."""
