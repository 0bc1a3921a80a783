"""What a machine tool is and how errors move its tool tip."""

import os

# onnxruntime reports its use to its maker over the internet by default, and keeps an id in the user's home for it. Its
# switch counts only before it is imported; a machine's network is nobody else's business.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
