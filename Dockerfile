# docker build -t gcbench .    docs/start/install.md tells how to run it
FROM python:3.13-slim
RUN apt-get update && apt-get install --yes --no-install-recommends libegl1 libgl1 libgl1-mesa-dri && rm -rf /var/lib/apt/lists/*
# `docker run --gpus all` brings NVIDIA's driver; this file tells EGL of it. Without it, Mesa renders.
RUN mkdir -p /usr/share/glvnd/egl_vendor.d && echo '{"file_format_version": "1.0.0", "ICD": {"library_path": "libEGL_nvidia.so.0"}}' > /usr/share/glvnd/egl_vendor.d/10_nvidia.json && install -d -m 1777 /cache
ENV NVIDIA_DRIVER_CAPABILITIES=compute,graphics,utility HOME=/cache
COPY . /src
RUN pip install --no-cache-dir /src && rm -r /src
WORKDIR /work
ENTRYPOINT ["gcbench"]
