"""What accuracy costs: error, seconds and bytes of many settings, each measured."""
