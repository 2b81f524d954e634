"""Find a DDS domain that nobody on this machine uses."""

from pathlib import Path
import random

# DDS derives its UDP ports from the domain; above 101 they reach into the range from which Linux
# hands out ports to anybody.
FIRST_DOMAIN = 1
LAST_DOMAIN = 100
PORT_BASE = 7400
PORTS_PER_DOMAIN = 250


def free_domain_id() -> int:
    """Return a domain none of whose UDP ports is in use on this machine.

    Domains are tried in random order, so that two processes that ask at the same time hardly ever
    get the same answer.

    Raises
    ------
    RuntimeError
        When every domain is in use.
    """
    used = {(port - PORT_BASE) // PORTS_PER_DOMAIN for port in _used_udp_ports()}
    free = [domain for domain in range(FIRST_DOMAIN, LAST_DOMAIN + 1) if domain not in used]
    if not free:
        raise RuntimeError(
            f'no free ROS domain: each of {FIRST_DOMAIN} to {LAST_DOMAIN} has UDP ports in use')
    return random.SystemRandom().choice(free)


def _used_udp_ports() -> set[int]:
    """Return the UDP ports that some process of this machine has bound."""
    ports: set[int] = set()
    for table in ('/proc/net/udp', '/proc/net/udp6'):
        try:
            rows = Path(table).read_text(encoding='ascii').splitlines()[1:]
        except OSError:
            # No such table without IPv6, or outside Linux: nothing is known to be in use.
            continue
        ports.update(int(row.split()[1].rpartition(':')[2], 16) for row in rows)
    return ports


if __name__ == '__main__':
    print(free_domain_id())
