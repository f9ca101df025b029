"""Which effects a scene calls for: estimates of what each is worth along the planned motion, and the cheapest set."""
