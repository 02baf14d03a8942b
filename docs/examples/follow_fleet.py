"""Follow five robots: python follow_fleet.py tcp/192.168.1.5:7447 amr1 amr2 amr3 amr4 amr5"""

import asyncio
import sys

from amr_slam.client import Fleet, Robot, SessionError, StalePoseError

DRIVABLE = ("localized", "mapping")


async def follow(robot: Robot) -> None:
    """Print where one robot is; say at once when there is no pose to drive by."""
    while True:
        try:
            async for pose in robot.poses(stale_s=0.5):
                drivable = pose.state in DRIVABLE and pose.error95_m < 0.1
                print(robot.name, f"{pose.x:.3f} {pose.y:.3f} {pose.theta:.3f}", drivable)
        except StalePoseError as stop:
            print("STOP", stop)
            await asyncio.sleep(0.5)


async def main(endpoint: str, names: list[str]) -> None:
    """All robots on one session."""
    async with Fleet(endpoint, names) as fleet, asyncio.TaskGroup() as tasks:
        for name in names:
            tasks.create_task(follow(fleet.robot(name)))


if __name__ == "__main__":
    try:
        asyncio.run(main(sys.argv[1], sys.argv[2:]))
    except SessionError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)
