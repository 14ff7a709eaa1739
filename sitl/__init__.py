"""The vehicles: physics, firmware and a payload tracker that speak MAVLink 2 and never see their pilot."""
