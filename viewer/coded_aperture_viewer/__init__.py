"""What a coded-aperture camera sees, live on a page in the browser. No ROS in here.

`live` works on frames in a thread, `packet` puts what comes of them into bytes, `server` sends
these to the page (`page.html`) and takes its settings, and `command` is the command line.
"""
