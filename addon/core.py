"""The gscore names that the add-on uses; the only add-on file that imports gscore."""

from typing import TYPE_CHECKING, Any

import gscore
from gscore import frontend

if TYPE_CHECKING:
    from gscore import *  # noqa: F403
    from gscore.frontend import *  # noqa: F403
else:

    def __getattr__(name: str) -> Any:
        """A public name of gscore or of its front-end interface, loaded on first use."""
        return getattr(gscore if name in gscore.__all__ else frontend, name)
