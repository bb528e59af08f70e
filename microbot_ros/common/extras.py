"""Libraries that only some features need, and the extra of the package that installs each."""

from __future__ import annotations

EXTRAS = {
    'av': 'video',
    'lz4': 'mcap', 'mcap': 'mcap', 'rosbags': 'mcap', 'zstandard': 'mcap',
    'pymodbus': 'modbus',
    'osqp': 'predictive',
    'jinja2': 'analysis', 'matplotlib': 'analysis', 'openpyxl': 'analysis', 'rich': 'analysis',
    'starlette': 'cockpit', 'uvicorn': 'cockpit', 'websockets': 'cockpit',
    'gymnasium': 'gym', 'onnx': 'onnx', 'onnxruntime': 'onnx',
    'dask': 'dask', 'distributed': 'dask', 'pyarrow': 'dask',
}
"""Library, by the name under which it is imported → the extra that installs it."""


def advice(error: ImportError) -> str | None:
    """Return which extra to install after an import `error`; None if no extra brings the library.
    """
    library = (error.name or '').partition('.')[0]
    if library not in EXTRAS:
        return None
    return (f"the library '{library}' is not installed; "
            f"pip install 'microbot_ros[{EXTRAS[library]}]'")
