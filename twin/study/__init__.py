"""Design-space sweeps: many virtual measurements that reuse each other's stage results."""
