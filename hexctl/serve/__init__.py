"""Put any LegServos on the network: server, lease, certificates, and the MAVLink board."""
