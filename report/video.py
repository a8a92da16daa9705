"""Short videos: H.264 in an MP4, which every browser and player takes.

In: pictures, uint8 [H, W, 3]. Out: a file.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from datasets.atomic import atomic_path


def encode_mp4(path: Path, images: Iterable[np.ndarray], size: tuple[int, int], fps: float, quality: int = 18) -> None:
    """Write pictures as an H.264 video that begins to play while it loads.

    Args:
        path: The file; what stands there is written over.
        images: uint8 [H, W, 3].
        size: Their width and height [px], both even.
        fps: Frames per second [Hz].
        quality: Constant rate factor of x264, 0..51: lower is better, 18 looks lossless.

    Raises:
        OSError: It could not be written in full.
    """
    import av

    count = 0
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        # 4:2:0 and the BT.709 matrix are what every player takes.
        stream = container.add_stream(
            "libx264", rate=Fraction(fps).limit_denominator(1001), options={"crf": f"{quality}", "preset": "medium"}
        )
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.thread_count = 1
        stream.codec_context.colorspace = stream.codec_context.color_primaries = stream.codec_context.color_trc = 1
        for image in images:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
            container.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
            count += 1
        container.mux(stream.encode(None))
    # The library does not tell of every failed write.
    with av.open(str(path)) as container:
        if sum(packet.size > 0 for packet in container.demux(video=0)) != count:
            raise OSError("the file system took only a part of it")


def write_video(path: str | os.PathLike, frames: np.ndarray, fps: float, quality: int = 24) -> None:
    """Write ``frames [T, H, W, 3]`` atomically, for a page: some tens of kilobytes a second; odd sizes lose a line."""
    if frames.ndim != 4 or frames.shape[-1] != 3 or frames.dtype != np.uint8 or len(frames) == 0:
        raise ValueError(f"expected images uint8 [T, H, W, 3], got {frames.dtype} {list(frames.shape)}")
    if not fps > 0:
        raise ValueError(f"write_video: frame rate {fps} Hz must be positive")
    height, width = (2 * (n // 2) for n in frames.shape[1:3])
    with atomic_path(path) as temporary:
        encode_mp4(Path(temporary), frames[:, :height, :width], (width, height), fps, quality)
