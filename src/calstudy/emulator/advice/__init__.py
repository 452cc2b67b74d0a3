"""What material tests would tell about the parameters, before they are made."""
