"""Design-space studies: many virtual measurements that reuse results of stages they share."""
