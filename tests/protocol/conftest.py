import pytest

FRAME_WORDS = 252


@pytest.fixture(scope="session")
def frame_of():
    def build(words, command=0):
        image = [0] * FRAME_WORDS
        image[0] = command
        for index, value in words.items():
            image[index] = value
        return b"".join(word.to_bytes(2, "little") for word in image)

    return build


@pytest.fixture(scope="session")
def words_of():
    def split(frame):
        return [int.from_bytes(frame[at : at + 2], "little") for at in range(0, len(frame), 2)]

    return split
