import sys; sys.path.insert(0,"/tmp/e60")
from exp9 import *
import pickle
ST.EVIDENCE=100.0; 
def forces(w,level):
    import dataclasses
    f=w.force(level.p,level.pixels); 
    # noise part: same weights
    from twinct.recon.ray_weights import some_views,OBJECT
    n2=[];m2=[]
    for v in some_views(len(level.A)):
        im=level.p[v]; sees=im>OBJECT*np.percentile(im,99.9); ww=w(im,v)[sees].astype(float)
        n2.append(np.mean(ww**2*(1/ww-w.model))); m2.append(np.mean(ww**2*w.model))
    return float(np.mean(n2)),float(np.mean(m2))
res=[]
for l in open(sys.argv[1]):
    r=json.loads(l); s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    known=None if s.photons is None else np.full(len(A),float(s.photons)); noise=noise_in_air(p,None,known)
    before=None
    for factor in (4,2,1):
        level=Level.of(A,p,None,factor,0.0,before); work=WorkingVolume(A.kernels,level.start())
        k=1 if factor==1 else factor; n=k*len(A); lastr=1.5*min(1.0,float(np.mean(level.A.domain_shape))/len(A))
        for view,share in zip(np.resize(spread_order(len(A)),n),np.geomspace(1.5,lastr,n)): level.update(work,int(view),float(share),0.0,False)
        x=work.array
        if factor<=2:
            m2=error_of_model(level.A,x); nl=None if noise is None else type(noise)(noise.in_air/factor,noise.source)
            w=RayWeights.of(nl,len(A),m2)
            if factor==2:
                t=ST.trial(level,x,w,0.0); r["powers"]=t.powers.tolist(); r["mis"]=t.misfits.tolist(); r["allowed"]=t.allowed/100; r["m2c"]=m2
            else:
                m=Minimiser(level,x,w,0.0); F=ST.Forces.of(m); r["F"]=(F.noise,F.model)
        before=(level,level.whole(x)) if factor>1 else None
    # fine best lambda in terms of lambda: best e -> lambda = beta*V/mean(A^T w A1)
    w3=1/(noise_var(p,s.photons)+np.float32(r["m2"])); V=float(np.prod(A.grid.voxel)); mean=float(A.T(A(np.ones(A.domain_shape,np.float32))*w3).mean())
    r["lams"]=[10*2.0**q["e"]/s.mu*V/mean for q in r["rows"]]
    res.append(r); print(r["seed"],flush=True)
pickle.dump(res,open("/tmp/e60/curves1.pkl","wb"))
