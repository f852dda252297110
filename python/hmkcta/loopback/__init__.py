"""A server on 127.0.0.1 for one user of this computer."""

from .listener import HOST as HOST
from .listener import POLICY as POLICY
from .listener import Listener as Listener
from .resource import Held as Held
from .resource import Resource as Resource
