"""Programs needed beside Python packages. Imports nothing: read before anything is installed."""

#: The packages of Debian, and of systems made from it.
PACKAGES = (
    "xvfb mesa-vulkan-drivers libvulkan1 libxkbcommon-x11-0 libxcursor1 libxi6 libxrandr2 "
    "chromium fonts-dejavu-core libegl1 libgl1 libgl1-mesa-dri"
)


class MissingProgramError(Exception):
    """Something that draws or shows is not installed."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what} is missing; on Debian: apt-get install --no-install-recommends {PACKAGES}")
