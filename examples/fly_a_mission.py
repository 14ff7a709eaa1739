"""A mission that this program flies: it looks at the load and decides where it goes."""

import asyncio

import cablequad as cq


async def main() -> None:
    """Up, to and fro until the load hangs still, and down."""
    async with cq.flying("ground-to-ground") as fleet:
        await fleet.preflight()
        await fleet.arm()
        await fleet.take_off()
        await fleet.tension()
        await fleet.lift()
        x, y, _ = fleet.load_m
        for step in (0.3, 0.6):
            await fleet.go(x + step, y, -1.2)
            print(
                f"{fleet.time_s:.1f} s: load at {fleet.load_m[0]:.2f} m, tensions {max(fleet.tensions_N):.1f} N at most"
            )
        await fleet.set_down()
        await fleet.release()
        await fleet.land()
        await fleet.disarm()
    assert fleet.summary is not None
    print(f"{fleet.summary.reason}; log: {fleet.summary.log}")


asyncio.run(main())
