"""Pause on the way, go on, and give up on purpose: what an operator may do, by script."""

SCENARIO = "ground-to-ground"


async def main(fleet):
    await fleet.preflight()
    await fleet.arm()
    await fleet.take_off()
    await fleet.tension()
    await fleet.lift()
    way = fleet.go(3.0, 0.0, -1.4)  # begins at once
    await fleet.wait(1.5)
    fleet.pause()
    await fleet.wait(3.0)
    fleet.resume()
    await way
    await fleet.set_down(3.0, 0.0)
    await fleet.release()
    await fleet.land()
    await fleet.disarm()
