"""Real autopilots under the load: physics interfaces of ArduPilot and PX4, and the joint step behind them."""
