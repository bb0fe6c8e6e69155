"""The viewer of the simulator with little memory: prints its port, and serves until it is ended.

Arguments: folder, and largest address space, GiB.
"""

import asyncio
import resource
import sys
from pathlib import Path

from coded_aperture_viewer import guard
from coded_aperture_viewer.show import listening_socket, make_server, serve
from live_viewer import viewer_options

if __name__ == "__main__":
    guard._LOG_PERIOD_S = 0.0  # every fault is told, not one a minute
    options = viewer_options(Path(sys.argv[1]))
    server, _ = make_server(options)
    listening = listening_socket(options.host, options.port)
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]) * 2**30,) * 2)
    print(listening.getsockname()[1], flush=True)
    asyncio.run(serve(server, listening))
