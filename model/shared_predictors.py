"""Predictors, one for each network on each kind of machine: machines of one type share it, since it remembers nothing.

So what it holds, and the replay of the stored sample, is there once for a hall of equal machines.
"""

from __future__ import annotations

import hashlib
import threading
from weakref import WeakValueDictionary

from model.bundle import Bundle
from model.predictor import Predictor

_alive: WeakValueDictionary[tuple[bytes, int, str], Predictor] = WeakValueDictionary()
_lock = threading.Lock()


def predictor_of(bundle: Bundle) -> Predictor:
    """Return the predictor of a bundle, a new one where no other of the same network on an equal machine is in use.

    Its maps name the machine that it was made for first, which differs from the bundle's in nothing but the name.

    Raises
    ------
    BundleError
        as `Predictor`.
    """
    network, record = bundle.network, bundle.manifest.network
    if network is None or record is None:
        return Predictor(bundle)  # which tells what is missing
    key = hashlib.sha256(network).digest(), id(record), bundle.machine.kind  # a predictor holds on to its record
    with _lock:
        found = _alive.get(key)
        if found is None or found.record is not record:
            found = _alive[key] = Predictor(bundle)
        return found
