"""What loops are worth, over a band of payloads and beside their limit of stability, and gains that serve best."""
