"""Design-space sweeps: many virtual measurements that share what they have in common."""
