"""Tilt all vehicles for a moment while they hover on slack cables, twice each way: what `cablequad identify` flies."""

SCENARIO = "ground-to-ground"
TILT_DEG, SHORT_S = 8.0, 0.3


async def main(fleet):
    await fleet.preflight()
    await fleet.arm()
    await fleet.take_off()
    fleet.say("hover")
    await fleet.wait(2.0)
    fleet.say("steps")
    for roll, pitch in ((TILT_DEG, 0.0), (0.0, TILT_DEG)) * 2:
        await fleet.tilt(roll, pitch, SHORT_S)
        await fleet.tilt(-roll, -pitch, 2 * SHORT_S)  # what the first gave in speed is taken again
        await fleet.tilt(roll, pitch, SHORT_S)
        await fleet.wait(1.0)
    fleet.say("done")
    await fleet.land()
    await fleet.disarm()
