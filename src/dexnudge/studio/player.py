"""Playing a recording: which moment is shown, and what comes next."""

from dataclasses import dataclass

from dexnudge.studio.playback import frame_at
from dexnudge.viewer.recording import Recording


@dataclass
class Player:
    """A recording at a moment.

    Attributes:
        name: as it was chosen; "" where nothing is played.
        recording: what is played.
        time: of the moment that is shown [s].
        speed: seconds of the recording in each second.
        running: whether it goes on by itself.
    """

    name: str = ""
    recording: Recording | None = None
    time: float = 0.0
    speed: float = 1.0
    running: bool = False

    @property
    def start(self) -> float:
        """Of the recording [s]."""
        return 0.0 if self.recording is None else float(self.recording.time[0])

    @property
    def end(self) -> float:
        """Of the recording [s]."""
        return 0.0 if self.recording is None else float(self.recording.time[-1])

    @property
    def frame(self) -> int:
        """The moment that is shown."""
        return 0 if self.recording is None else frame_at(self.recording, self.time)

    def load(self, name: str, recording: Recording | None) -> None:
        """Begin with another recording, or with none; it does not run yet."""
        self.name, self.recording, self.running = name, recording, False
        self.time = self.start

    def seek(self, time: float) -> None:
        """Go to a moment [s]."""
        self.time = min(max(time, self.start), self.end)

    def toggle(self) -> None:
        """Run or hold; from the end it begins again."""
        self.running = self.recording is not None and not self.running
        if self.running and self.time >= self.end:
            self.time = self.start

    def advance(self, seconds: float) -> bool:
        """Go on by as many seconds of the clock where it runs; return whether it did. At the end it holds."""
        if not self.running:
            return False
        self.seek(self.time + self.speed * seconds)
        self.running = self.time < self.end
        return True
