import hashlib
import shutil
import struct
import subprocess

import pytest
from emulated import NEEDED, ROOT, require

pytestmark = pytest.mark.xdist_group("emulated board")

FLASH = 0x10000000
RP2040 = 0xE48BFF56
IMAGES = ("mps2.elf", "rp2040.elf", "rp2040.bin", "rp2040.uf2")


@pytest.fixture(scope="module")
def builds(tmp_path_factory):
    """The images, built in two folders."""
    require(*NEEDED["mps2"])
    folders = [tmp_path_factory.mktemp(name) / "firmware" for name in ("one", "another with a longer name")]
    running = []
    for folder in folders:
        shutil.copytree(ROOT / "firmware", folder, ignore=shutil.ignore_patterns("build", "node_modules"))
        running.append(subprocess.Popen(["make", "-C", folder], stdout=subprocess.PIPE, text=True))
    said = [process.communicate()[0] for process in running]
    assert [process.returncode for process in running] == [0, 0]
    return folders, said


def test_everybody_gets_the_same_bits(builds):
    folders, said = builds
    sums = [[hashlib.sha256((each / "build" / name).read_bytes()).hexdigest() for name in IMAGES] for each in folders]
    assert sums[0] == sums[1]
    for digest, name in zip(sums[0], IMAGES, strict=True):
        assert f"{digest}  {name}" in said[0], "the build prints what it made"


def test_the_uf2_file_is_the_image_in_blocks_for_the_chips_flash(builds):
    build = builds[0][0] / "build"
    image, uf2 = (build / "rp2040.bin").read_bytes(), (build / "rp2040.uf2").read_bytes()
    blocks = [uf2[at : at + 512] for at in range(0, len(uf2), 512)]
    assert b"".join(block[32 : 32 + 256] for block in blocks) == image
    for i, block in enumerate(blocks):
        start = (0x0A324655, 0x9E5D5157, 0x2000, FLASH + 256 * i, 256, i, len(blocks), RP2040)
        assert struct.unpack_from("<8I", block) == start
        assert struct.unpack_from("<I", block, 508) == (0x0AB16F30,)
