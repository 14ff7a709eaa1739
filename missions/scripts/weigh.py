"""Tension the cables and let go again, twice, without lifting: a rehearsal of the hand-over on the ground."""

SCENARIO = "ground-to-ground"


async def main(fleet):
    await fleet.preflight()
    await fleet.arm()
    await fleet.take_off()
    for _ in range(2):
        await fleet.tension()
        fleet.say(f"tensions {[round(t, 1) for t in fleet.tensions_N]} N")
        await fleet.wait(1.0)
        await fleet.release()
    await fleet.land()
    await fleet.disarm()
