"""What the fused pose is worth between two scans, and whether it knows."""
