"""A control loop on asyncio: of each frame that comes, only the newest; grip harder before the object slides.

python hold_without_slip.py [SECONDS]
"""

import asyncio
import sys

import ruffini

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
MARGIN = 0.3  # of the shear that friction still takes


def grip(more_n: float) -> None:
    """Where your gripper's driver is called."""
    print(f"grip by {more_n:+.2f} N")


async def hold() -> None:
    async with ruffini.connect_async(field=0, depth=0, on_note=print) as sensor:
        async for frame in sensor.frames(newest=True):
            if not frame.is_valid or frame.contacts is None:
                continue  # hold still: nothing is known of the force
            for contact in frame.contacts.contacts:
                if contact.slip_state == "slides":
                    grip(+1.0)
                elif contact.slip_margin_n is not None and contact.slip_margin_n < MARGIN * abs(contact.force[2]):
                    grip(+0.2)


async def main() -> None:
    try:
        await asyncio.wait_for(hold(), SECONDS)
    except asyncio.TimeoutError:
        print("done")


asyncio.run(main())
