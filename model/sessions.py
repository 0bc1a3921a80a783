"""Sessions of onnxruntime, one for each network: machines of one type share it, since it remembers nothing."""

from __future__ import annotations

import hashlib
import threading
from weakref import WeakValueDictionary

import onnxruntime

_open: WeakValueDictionary[bytes, onnxruntime.InferenceSession] = WeakValueDictionary()
_lock = threading.Lock()


def session_of(network: bytes) -> onnxruntime.InferenceSession:
    """Return the session of a network, given as the bytes of its ONNX file; it may be run from several threads.

    Raises
    ------
    Exception
        of onnxruntime's own, where the network cannot be loaded.
    """
    key = hashlib.sha256(network).digest()
    with _lock:
        session = _open.get(key)
        if session is None:
            options = onnxruntime.SessionOptions()
            # One sample is too small to share out; threads would only wait for each other. Nor is it worth an arena,
            # which keeps what was ever needed.
            options.intra_op_num_threads = options.inter_op_num_threads = 1
            options.enable_cpu_mem_arena = False
            options.log_severity_level = 4  # what is wrong is raised, and told once
            session = _open[key] = onnxruntime.InferenceSession(network, options, ["CPUExecutionProvider"])
        return session
