"""Which paths a target may take: graphs of states, velocities and transitions."""
