"""Carry the load over two posts, look at it from still air at each, and bring it back to where it was picked up."""

SCENARIO = "ground-to-ground"


async def main(fleet):
    home = fleet.load_m
    await fleet.preflight()
    await fleet.arm()
    await fleet.take_off()
    await fleet.tension()
    await fleet.lift()
    for x, y in ((1.5, 0.0), (1.5, 1.5)):
        await fleet.go(x, y, -1.4)
        await fleet.wait(2.0)
        fleet.say(f"at ({x}, {y}): the load is {fleet.load_m[2]:.2f} m down, battery {min(fleet.batteries):.0%}")
    await fleet.go(home[0], home[1], -1.1)
    await fleet.set_down()
    await fleet.release()
    await fleet.land()
    await fleet.disarm()
