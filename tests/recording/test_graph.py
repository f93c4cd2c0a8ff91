"""What is heard over ROS 2 is written, whatever the order in which it comes."""

from collections import Counter

from twinct.link.recording.graph import PARTS, GraphRecorder
from twinct.link.recording.reader import RecordedMessage, Recording
from twinct.link.senders import Raw
from twinct.link.tap import Heard
from twinct.link.topics import IMAGE, KINDS, REACHED


def test_an_image_asked_for_again_is_written_each_time(take, tmp_path):
    known = take(tmp_path / "known", "cell={kind: gantry}")
    said = [
        r for r in Recording(known.folder / "scan.mcap").records() if isinstance(r, RecordedMessage)
    ]
    stamp = next(s.stamp_ns for s in said if s.topic == IMAGE)
    of_view = {s.topic: s for s in said if s.topic in (*PARTS, IMAGE) and s.stamp_ns == stamp}
    recording = GraphRecorder(tmp_path)
    recording.begin(known.builder, 0)
    numbers = Counter()

    def hear(topic):
        numbers[topic] += 1
        raw = Raw(of_view[topic].data, 1, 2)
        recording.hear(Heard(topic, KINDS[topic], raw, numbers[topic], topic))

    for topic in (IMAGE, IMAGE, *PARTS, IMAGE):
        hear(topic)
    assert recording.has_images(1)
    numbers[REACHED] += 2
    hear(REACHED)
    recording.close()
    assert recording.problems == [f"{recording.path} lacks 2 messages of {REACHED}"]
    written = Counter(
        r.topic for r in Recording(recording.path).records() if isinstance(r, RecordedMessage)
    )
    assert written[IMAGE] == 3 and written["/tf"] == 1
