"""The demo: both nodes and a listener as three processes over DDS."""
